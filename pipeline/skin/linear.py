"""Symmetric indefinite sparse systems: analysed once, refactored as the values change.

MKL's PARDISO (O. Schenk and K. Gaertner, Future Gener. Comput. Syst. 20 (2004) 475) where it is installed (x86-64),
else SciPy's SuperLU in its symmetric mode. The tangent of a pressed
skin can be indefinite, so Cholesky would not do.
"""

import os
import sys
import warnings

import numpy as np
import scipy.sparse as sparse
from scipy.sparse.linalg import splu


def linear_solver() -> "Pardiso | SuperLU":
    """PARDISO, or where it is not installed SuperLU."""
    try:
        return Pardiso()
    except ImportError:
        return SuperLU()


class Pardiso:
    """LDL^T by MKL, through the library that pypardiso finds; on the calling thread alone.

    In single precision, which halves the time of both phases: the factor is held over many postures and only
    has to point the right way. Pivots stay on the diagonal, so that their signs show
    whether the posture is stable; the 2 x 2 pivots of Bunch and Kaufman (Math. Comp. 31 (1977) 163) would double the
    time.
    """

    def __init__(self) -> None:
        # First: `__del__` asks for it even where the rest fails.
        self._upper: sparse.csr_matrix | None = None
        from pypardiso import PyPardisoSolver

        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            self._mkl = PyPardisoSolver(mtype=-2)
        # Found by a search through the whole environment: once, also for processes that are started from here.
        os.environ.setdefault("PYPARDISO_MKL_RT", self._mkl.libmkl._name)
        self._mkl.libmkl.MKL_Set_Num_Threads(1)
        for place, value in {1: 1, 2: 2, 8: 0, 10: 8, 11: 0, 13: 0, 21: 0, 24: 0, 28: 1}.items():
            self._mkl.iparm[place - 1] = value

    def factor(self, upper: sparse.csr_matrix) -> None:
        """Of the matrix whose upper triangle is given."""
        single = sparse.csr_matrix((upper.data.astype(np.float32), upper.indices, upper.indptr), upper.shape)
        if self._upper is None:
            self._call(11, single, np.zeros(upper.shape[0], np.float32))
        self._upper = single
        self._call(22, single, np.zeros(upper.shape[0], np.float32))

    def solve(self, right: np.ndarray) -> np.ndarray:
        assert self._upper is not None, "factor first"
        return self._call(33, self._upper, right.astype(np.float32)).astype(float)

    @property
    def negative(self) -> int:
        """How many pivots are negative: none where the posture is stable."""
        return int(self._mkl.iparm[22])

    def _call(self, phase: int, upper: sparse.csr_matrix, right: np.ndarray) -> np.ndarray:
        self._mkl.set_phase(phase)
        # By address: MKL takes what is there for single precision, as iparm 28 says.
        return self._mkl._call_pardiso(upper, right)

    def __del__(self) -> None:
        if self._upper is not None and not sys.is_finalizing():
            self._call(-1, self._upper, np.zeros(self._upper.shape[0], np.float32))


class SuperLU:
    """LU by SciPy with the pattern's symmetry used in the ordering."""

    def factor(self, upper: sparse.csr_matrix) -> None:
        full = upper + sparse.triu(upper, 1).T
        self._factors = splu(
            full.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.01, options={"SymmetricMode": True}
        )

    def solve(self, right: np.ndarray) -> np.ndarray:
        return self._factors.solve(right)

    @property
    def negative(self) -> int:
        return int((self._factors.U.diagonal() < 0).sum())
