"""The paper's method: descriptors, functional maps, point maps (sections 5.1 - 5.4); and the improved `hfm`.

Section 4, the hierarchical basis (eqs. 1 - 11), is in `cagemap.spectral`.
"""
