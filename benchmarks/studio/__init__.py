"""How long the studio lets one wait, measured in a headless browser: `python -m benchmarks.studio [--triangles N]`."""
