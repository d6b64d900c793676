"""Arrays and sparse matrices as tensors of torch, which is optional."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse

from cagemap.errors import ParameterError


def tensors(*values: Any, dtype: Any = None, device: Any = None) -> Any:
    """Tensors of torch from arrays and SciPy's sparse matrices, which become coalesced COO tensors.

    Whole numbers stay whole. The other way needs nothing: functions that take arrays take tensors too.

    Parameters
    ----------
    *values : arrays or sparse arrays
    dtype : torch.dtype, optional
        Of real numbers; default: theirs.
    device : torch.device or str, optional

    Returns
    -------
    tensor, or tuple of tensors

    Raises
    ------
    ParameterError
        If torch is not installed.
    """
    try:
        import torch
    except ImportError as error:
        raise ParameterError("tensors: expected torch to be installed, found none; `pip install torch`") from error

    def made(value: Any) -> Any:
        if sparse.issparse(value):
            entries: Any = sparse.coo_array(value)  # type: ignore[call-overload]
            places = torch.as_tensor(np.stack(entries.coords).astype(np.int64))
            data = torch.as_tensor(np.array(entries.data))
            found = torch.sparse_coo_tensor(places, data, entries.shape, check_invariants=False).coalesce()
        else:
            found = torch.as_tensor(np.array(value))  # a copy: ours are read-only
        return found.to(device=device, dtype=dtype if found.is_floating_point() else None)

    found = tuple(made(value) for value in values)
    return found[0] if len(found) == 1 else found
