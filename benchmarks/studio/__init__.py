"""Waits of the studio as its page shows them, and a new user's way from nothing to a baked texture."""
