"""What the add-on tells the user when something cannot be done."""


class RefusedError(Exception):
    """What cannot be done, and what to do about it; shown to the user as it is."""
