"""How far the eigenvalues of one level are above those of the surface, without computing finer ones."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from cagemap.basis.products import multiply

FloatArray = NDArray[np.float64]


def eigenvalue_excess(
    subdivision: sparse.csr_array,
    stiffness: sparse.csr_array,
    mass: sparse.csr_array,
    values: FloatArray,
    vectors: FloatArray,
    *,
    steps: int = 4,
) -> FloatArray:
    """How much lower the eigenvalues of the next level are: lambda^l - lambda^{l+1}, estimated.

    The residual of a prolonged pair, r = (W^{l+1} - lambda M^{l+1}) S x, is orthogonal to the image of S (paper, eq. 2),
    so what it lacks is of high frequency, where W^{l+1} is well conditioned once scaled by its diagonal. A few steps of
    conjugate gradients on W^{l+1} z = r give the energy r^T z that a correction within level l + 1 would gain.

    Parameters
    ----------
    subdivision : (n_{l+1}, n_l) CSR array
        S^l.
    stiffness, mass : (n_{l+1}, n_{l+1}) CSR arrays
        Of the next level.
    values : (m,) array
    vectors : (n_l, m) array
        Eigenpairs of level l, M-orthonormal.
    steps : int
        Conjugate gradient steps; the estimate grows with every one, towards a limit.

    Returns
    -------
    (m,) array
        Not negative. Unit of the eigenvalues.
    """
    prolonged = multiply(subdivision, vectors)
    residual = multiply(stiffness, prolonged) - multiply(mass, prolonged) * values
    diagonal = stiffness.diagonal()[:, None]
    gained = np.zeros(len(values))
    direction = residual / diagonal
    product = np.einsum("ij,ij->j", residual, direction)
    for step in range(steps):
        image = multiply(stiffness, direction)
        curvature = np.einsum("ij,ij->j", direction, image)
        length = product / np.where(curvature > 0.0, curvature, 1.0)
        gained += length * product
        if step == steps - 1:
            break
        residual = residual - image * length
        scaled = residual / diagonal
        previous, product = product, np.einsum("ij,ij->j", residual, scaled)
        direction = scaled + direction * (product / np.where(previous > 0.0, previous, 1.0))
    # The correction has a Rayleigh quotient mu of its own, and (W - lambda M) is smaller than W by lambda / mu on it.
    return gained
