"""Reading and writing of landmarks, curves and symmetries."""
