"""Requests of the tasks: one dataclass for each command; its fields are the command's options."""
