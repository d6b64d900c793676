"""Threads, sparse factorisations, sparse products and argument checks, used by all other packages."""
