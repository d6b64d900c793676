"""The elastic fit: the target is deformed onto the source."""
