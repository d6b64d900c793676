"""Plain meshes (scheme none) against the cages whose refined surfaces they are: accuracy, time and memory."""
