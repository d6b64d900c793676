"""Many pairs by one job: what a local cluster costs, what a rerun costs, and whether a spoiled pair is found."""
