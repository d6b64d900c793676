"""Accuracy of maps against ground truth (humans) and without it (animals): protocol B."""
