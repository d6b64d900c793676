"""Arrays, threads, sparse factorisations and argument checks, used by all other packages."""
