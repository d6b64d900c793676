"""Maps with few landmarks or none: candidate alignments, the best one, and its confidence."""
