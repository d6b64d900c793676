"""Arrays, threads, sparse factorisations and products, and argument checks, used by all other packages."""
