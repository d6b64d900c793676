"""Threads, sparse factorisations and products: what every room above computes with."""
