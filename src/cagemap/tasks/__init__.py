"""Tasks of the command line, job files and the studio: one request and one function each."""
