"""Short text of configurations."""

from __future__ import annotations

from dataclasses import MISSING, fields


class Brief:
    """A dataclass (``repr=False``) that shows the fields that differ from their defaults."""

    def __repr__(self) -> str:
        shown = []
        for field in fields(self):  # type: ignore[arg-type]
            default = field.default_factory() if field.default_factory is not MISSING else field.default
            value = getattr(self, field.name)
            if not (type(value) is type(default) and value == default):
                shown.append(f"{field.name}={value!r}")
        return f"{type(self).__name__}({', '.join(shown)})"
