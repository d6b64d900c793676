"""The speed benchmark (protocol A): every part checks its result before its time counts.

``python -m benchmarks.speed`` runs all parts; see ``--help``.
"""
