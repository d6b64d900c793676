"""Public sets of shapes with known correspondence: FAUST, FAUST_r, SMAL_r, SHREC'20. The data lies in no repository."""
