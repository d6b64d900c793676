"""What is asked of each task: one dataclass each, with the words of its options."""
