"""What a user does: one request and one function for each task, for the command line, job files and the studio."""
