"""Linear state-space models, in discrete or continuous time.

    x_{k+1} = A x_k + B u_k + K e_k        y_k = C x_k + D u_k + e_k

The names are those of the control literature. Bargouth (2022) and Di Ruscio write D for the
output matrix C and E for the direct term D; K is the gain of the *predictor* (A M, with M the
gain of the filter) and F a factor of the innovations' covariance, cov(e) = F F'. An output y_k is
paired with the input u_k that is held over [t_k, t_{k+1}), so a sampled vessel has D = 0.

In continuous time `period_s` is None and x_{k+1} stands for the derivative of x.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy

from seatrial.models.compiled import kernel
from seatrial.models.errors import ConfigurationError
from seatrial.models.ranges import Positive, check_ranges
from seatrial.models.vessel.basis import Array

RANK_TOLERANCE = 1e-9  # of a direction in the controllable space, relative to the norm of A


@dataclass(frozen=True, eq=False)
class StateSpace:
    """A linear model with n states, r inputs and m outputs.

    `period_s` [s] is the sample time, None in continuous time; `x0` the state at the first sample
    of the data that the model was identified from.
    """

    A: Array  # (n, n)
    B: Array  # (n, r)
    C: Array  # (m, n)
    D: Array  # (m, r)
    period_s: Positive | None
    K: Array | None = None  # (n, m)
    F: Array | None = None  # (m, m)
    x0: Array | None = None  # (n,)
    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        check_ranges(self)
        n, r, m = self.A.shape[0], self.B.shape[1], self.C.shape[0]
        shapes: dict[str, tuple[int, ...]] = {"A": (n, n), "B": (n, r), "C": (m, n), "D": (m, r)}
        shapes |= {"K": (n, m), "F": (m, m), "x0": (n,)}
        for name, shape in shapes.items():
            matrix = getattr(self, name)
            if matrix is None:
                continue
            frozen = np.array(matrix, dtype=np.float64)
            if frozen.shape != shape:
                raise ConfigurationError(f"{name}: got shape {frozen.shape}, expected {shape}")
            frozen.setflags(write=False)
            object.__setattr__(self, name, frozen)
        for name, count, letter in (("inputs", r, "u"), ("outputs", m, "y")):
            names = getattr(self, name) or tuple(f"{letter}{i + 1}" for i in range(count))
            if len(names) != count:
                raise ConfigurationError(f"{name}: got {len(names)} names, expected {count}")
            object.__setattr__(self, name, names)

    @property
    def order(self) -> int:
        """Number of states."""
        return len(self.A)

    @cached_property
    def eigenvalues(self) -> Array:
        """Eigenvalues of A, complex, the largest magnitude first; shape (n,)."""
        values = np.linalg.eigvals(self.A)
        return np.asarray(values[np.argsort(-np.abs(values), kind="stable")])

    @property
    def spectral_radius(self) -> float:
        """Largest magnitude of an eigenvalue of A."""
        return spectral_radius(self.A)

    @property
    def stable(self) -> bool:
        """Whether the model is asymptotically stable; an integrator is not."""
        if self.period_s is None:
            return bool(np.max(self.eigenvalues.real) < 0.0)
        return self.spectral_radius < 1.0

    @property
    def predictor_radius(self) -> float:
        """Spectral radius of A - K C; below 1 the predictor forgets its initial state."""
        return spectral_radius(self.A - self._gain() @ self.C)

    @property
    def controllable_order(self) -> int:
        """Dimension of the controllable subspace; equals `order` if controllable."""
        return reachable_order(self.A, self.B)

    @property
    def observable_order(self) -> int:
        """Dimension of the observable subspace; equals `order` if observable."""
        return reachable_order(self.A.T, self.C.T)

    def markov(self, count: int) -> Array:
        """Markov parameters D, C B, C A B, ... of the input, shape (count, m, r)."""
        parameters = np.empty((count, len(self.C), self.B.shape[1]))
        reached = self.B
        for i in range(count):
            parameters[i] = self.D if i == 0 else self.C @ reached
            reached = reached if i == 0 else self.A @ reached
        return parameters

    def simulate(self, u: Array, x0: Array | None = None) -> Array:
        """Outputs (N, m) of the inputs u (N, r) alone, from `x0` (default the model's, or 0)."""
        self._discrete("simulate")
        y = np.empty((len(u), len(self.C)))
        _simulate(self.A, self.B, self.C, self.D, self._start(x0), _rows(u), y)
        return y

    def predict(self, y: Array, u: Array, steps: int = 1, x0: Array | None = None) -> Array:
        """Predictions of y_k from the data up to k - `steps` and all inputs; shape (N, m).

        The first `steps` - 1 rows are free-run from `x0`.
        """
        self._discrete("predict")
        if steps < 1:
            raise ConfigurationError(f"steps must be at least 1, got {steps}")
        predicted = np.empty((len(u), len(self.C)))
        matrices = (self.A, self.B, self.C, self.D, self._gain())
        _predict(*matrices, self._start(x0), _rows(y), _rows(u), steps, predicted)
        return predicted

    def initial_state(self, y: Array, u: Array, free_run: bool = False) -> Array:
        """Least-squares state at the first sample of the data, of the predictor or a free run."""
        zero = np.zeros(self.order)
        gain = np.zeros_like(self.C.T) if free_run else self._gain()
        forced = self.simulate(u, zero) if free_run else self.predict(y, u, 1, zero)
        free = np.empty((len(u), *self.C.shape))
        _free(self.A - gain @ self.C, self.C, free)
        rows = free.reshape(-1, self.order)
        state = np.linalg.lstsq(rows, (y - forced).ravel(), rcond=None)[0]
        return np.asarray(state, dtype=np.float64)

    def discretised(self, period_s: float) -> "StateSpace":
        """The same model sampled with a zero-order hold on its inputs. Bargouth (2022), (3.30)."""
        if self.period_s is not None:
            raise ConfigurationError(f"the model is discrete already, period {self.period_s:g} s")
        a, b = zero_order_hold(self.A, self.B, period_s)
        return replace(self, A=a, B=b, period_s=period_s)

    def with_integral_action(self) -> "StateSpace":
        """Incremental form: state (Delta x_k, y_{k-1} - r), input Delta u_k, output y_k - r.

        A~ = [A 0; C I], B~ = [B; 0], C~ = [C I]. Bargouth (2022), (3.41)-(3.44).
        """
        self._discrete("integral action")
        if np.any(self.D != 0.0):
            raise ConfigurationError(
                "integral action: the model has a direct term D, expected none"
            )
        n, m, r = self.order, len(self.C), self.B.shape[1]
        a = np.block([[self.A, np.zeros((n, m))], [self.C, np.eye(m)]])
        b = np.vstack([self.B, np.zeros((m, r))])
        c = np.hstack([self.C, np.eye(m)])
        return replace(self, A=a, B=b, C=c, K=None, F=None, x0=None)

    def transformed(self, T: Array) -> "StateSpace":
        """The same model with the state T x; T (n, n) is invertible."""
        inverse = np.linalg.inv(T)
        return replace(
            self, A=T @ self.A @ inverse, B=T @ self.B, C=self.C @ inverse,
            K=None if self.K is None else T @ self.K, x0=None if self.x0 is None else T @ self.x0,
        )  # fmt: skip

    def scaled(self, input_scale: Array, output_scale: Array) -> "StateSpace":
        """The model between inputs multiplied by `input_scale` (r,) and outputs by the other (m,).

        A model of normalised data u/s, y/q becomes one of u and y by scaled(s, q).
        """
        up = output_scale[:, None]
        return replace(
            self, B=self.B / input_scale, C=up * self.C, D=up * self.D / input_scale,
            K=None if self.K is None else self.K / output_scale,
            F=None if self.F is None else up * self.F,
        )  # fmt: skip

    def _start(self, x0: Array | None) -> Array:
        state = self.x0 if x0 is None else x0
        return np.zeros(self.order) if state is None else np.array(state, dtype=np.float64)

    def _gain(self) -> Array:
        if self.K is None:
            raise ConfigurationError("the model has no innovations gain K, so it cannot predict")
        return self.K

    def _discrete(self, what: str) -> None:
        if self.period_s is None:
            raise ConfigurationError(f"{what}: the model is continuous, discretise it first")


def spectral_radius(A: Array) -> float:
    """Largest magnitude of an eigenvalue; inf where the entries have become too large."""
    if not np.all(np.isfinite(A)):
        return np.inf
    return float(np.max(np.abs(np.linalg.eigvals(A)), initial=0.0))


def zero_order_hold(A: Array, B: Array, period_s: float) -> tuple[Array, Array]:
    """exp(A h) and its integral times B: exact for inputs that are held over the period [s]."""
    n = len(A)
    block = np.zeros((n + B.shape[1], n + B.shape[1]))
    block[:n, :n], block[:n, n:] = A, B
    with np.errstate(over="ignore", invalid="ignore"):  # a mode that grows at once
        exact = scipy.linalg.expm(block * period_s)
    return exact[:n, :n], exact[:n, n:]


def reachable_order(A: Array, B: Array) -> int:
    """Rank of the controllability matrix [B, A B, ...], found one block at a time.

    The states are balanced and each input is scaled to unit effect, so units have no influence (the
    effects of 1 N and 1 Nm differ by 1e5 in a ship); every new block is orthogonal to what
    is reached already, so powers of A have no influence either. Bargouth (2022), (3.32).
    """
    balanced, (scale, _) = scipy.linalg.matrix_balance(A, permute=False, separate=True)
    effect = B / scale[:, None]
    size = np.linalg.norm(effect, axis=0)
    new = effect[:, size > 0.0] / size[size > 0.0]
    reached = np.zeros((len(A), 0))
    limit = RANK_TOLERANCE * max(1.0, float(np.linalg.norm(balanced)))
    while new.size and reached.shape[1] < len(A):
        for _ in range(2):  # once more: a single pass leaves rounding of the size of the limit
            new = new - reached @ (reached.T @ new)
        directions, sizes, _ = np.linalg.svd(new, full_matrices=False)
        new = directions[:, sizes > limit]
        reached = np.hstack([reached, new])
        new = balanced @ new
    return int(reached.shape[1])


def _rows(values: Array) -> Array:
    return np.ascontiguousarray(values, dtype=np.float64)


@kernel
def _add_product(matrix: Array, vector: Array, out: Array) -> None:
    """out += matrix vector."""
    for i in range(matrix.shape[0]):
        total = 0.0
        for j in range(matrix.shape[1]):
            total += matrix[i, j] * vector[j]
        out[i] += total


@kernel
def _free(A: Array, C: Array, y: Array) -> None:
    """Write y_k = C A^k, shape (N, m, n): free responses to every unit initial state."""
    n, m = A.shape[0], C.shape[0]
    x, following = np.eye(n), np.empty((n, n))
    for k in range(y.shape[0]):
        for i in range(m):
            for c in range(n):
                y[k, i, c] = 0.0
            for j in range(n):
                for c in range(n):
                    y[k, i, c] += C[i, j] * x[j, c]
        for i in range(n):
            for c in range(n):
                following[i, c] = 0.0
            for j in range(n):
                for c in range(n):
                    following[i, c] += A[i, j] * x[j, c]
        x, following = following, x


@kernel
def _simulate(A: Array, B: Array, C: Array, D: Array, x0: Array, u: Array, y: Array) -> None:
    """y_k = C x_k + D u_k while x_{k+1} = A x_k + B u_k."""
    x = x0.copy()
    following = np.empty_like(x)
    y[:] = 0.0
    for k in range(u.shape[0]):
        _add_product(C, x, y[k])
        _add_product(D, u[k], y[k])
        following[:] = 0.0
        _add_product(A, x, following)
        _add_product(B, u[k], following)
        x, following = following, x


@kernel
def _predict(
    A: Array, B: Array, C: Array, D: Array, K: Array, x0: Array, y: Array, u: Array, steps: int,
    predicted: Array,
) -> None:  # fmt: skip
    """Predictions `steps` ahead of the filter x_{k+1} = A x_k + B u_k + K (y_k - C x_k - D u_k)."""
    n_rows = u.shape[0]
    x, ahead, following = x0.copy(), x0.copy(), x0.copy()
    error = np.empty(y.shape[1])
    predicted[:] = 0.0
    for k in range(n_rows):
        first = 0 if k == 0 else steps - 1
        for i in range(x.shape[0]):
            ahead[i] = x[i]
        for i in range(min(steps, n_rows - k)):
            if i >= first:
                _add_product(C, ahead, predicted[k + i])
                _add_product(D, u[k + i], predicted[k + i])
            following[:] = 0.0
            _add_product(A, ahead, following)
            _add_product(B, u[k + i], following)
            ahead, following = following, ahead
        error[:] = 0.0
        _add_product(C, x, error)
        _add_product(D, u[k], error)
        following[:] = 0.0
        _add_product(A, x, following)
        _add_product(B, u[k], following)
        for i in range(error.shape[0]):
            error[i] = y[k, i] - error[i]
        _add_product(K, error, following)
        x, following = following, x
