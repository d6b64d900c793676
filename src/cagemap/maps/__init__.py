"""Point maps between surfaces: the methods that find them, and what judges them."""
