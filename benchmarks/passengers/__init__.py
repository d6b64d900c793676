"""Passengers carried from body to body, against MakeHuman's own fitting."""
