"""Requests of the tasks: one dataclass each, annotated with its options."""
