"""Turn fitted positions into points of the source: project them and remove folds."""
