"""Which landmarks contradict the others."""
