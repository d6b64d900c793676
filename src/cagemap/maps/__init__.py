"""Point maps between surfaces: how they are found and judged."""
