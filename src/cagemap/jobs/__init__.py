"""Jobs of many pairs: job files, plans of tasks, and their execution."""
