"""A character: body, passengers (clothes, eyes, hair), skeleton, animations; and carrying it to another body."""
