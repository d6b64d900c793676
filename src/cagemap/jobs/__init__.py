"""Jobs of many pairs: job files, plans of tasks, and their execution."""

from __future__ import annotations

# Option of an output that names a layer; several outputs of a pair may add to one layer.
LAYER_OPTION = "usd"
