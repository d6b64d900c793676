"""Characters (body, passengers such as clothes, skeleton, animations) and their transfer to another body."""
