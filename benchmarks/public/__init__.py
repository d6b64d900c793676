"""Public sets of shapes with known correspondence: FAUST and its parts, SMAL_r, SHREC'19, SHREC'20, TOSCA.

The data lies in no repository.
"""
