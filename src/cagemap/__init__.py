"""Dense maps between subdivision surfaces from their control meshes and a few landmarks."""

__version__ = "0.1.0"
