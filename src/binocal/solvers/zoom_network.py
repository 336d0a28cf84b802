"""Curves through calibrations at several zoom settings: a polynomial, and a network trained by back-propagation for what it leaves.

The loss is the reprojection error of all settings' corners, to second order about each setting's own optimum: the squared distance
from the estimate there in the metric of its information. So what a setting does not tell, it does not ask for. The network's
weights have a Gaussian prior whose width is found from the data (MacKay 1992, "A practical Bayesian framework for backpropagation
networks", eqs 3.7 and 3.8); Gauss-Newton steps follow the back-propagated derivatives (Foresee & Hagan 1997).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from binocal.cameras.zoom_rig import Network
from binocal.shapes import Float

N_HIDDEN = 6
INTO_SIGMA = 2.0  # of the hidden layer's weights: a bend of tanh within the range
MAX_STEPS = 60
SETTLED = 1e-6  # of the loss
EVIDENCE_EVERY = 4  # steps between two looks at the prior's width
LEAST_PRECISION, MOST_PRECISION = 1e-2, 1e8


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """A network, its loss, and the covariance of its outputs at any setting.

    ``triangle`` is the inverse of R with Rᵀ R the information of the weights.
    """

    network: Network
    loss: float
    triangle: Float[ndarray, "w w"]

    def output_covariance(self, x: float) -> Float[ndarray, "q q"]:
        """Of the curves at a setting in [-1, 1], in standard units: what the calibrations' own errors leave of them."""
        J = _derivatives(self.network, x) @ self.triangle
        return J @ J.T


def fit_network(
    x: Float[ndarray, "k"],
    targets: Float[ndarray, "k q"],
    roots: Float[ndarray, "k q q"],
    rng: np.random.Generator,
    *,
    degree: int,
    n_hidden: int = N_HIDDEN,
) -> Fitted:
    """A network fitted to ``targets`` at settings ``x`` in [-1, 1]; ``roots`` L with L Lᵀ the information of each target.

    ``n_hidden`` 0 fits the polynomial alone.
    """
    q = targets.shape[1]
    network = Network(
        np.zeros((degree + 1, q)),
        rng.normal(0, INTO_SIGMA, n_hidden),
        rng.uniform(-INTO_SIGMA, INTO_SIGMA, n_hidden),
        np.zeros((n_hidden, q)),
    )
    n_polynomial = (degree + 1) * q
    precision = np.r_[np.full(n_polynomial, 1e-8), np.full(2 * n_hidden, INTO_SIGMA**-2), np.full(n_hidden * q, 1.0)]
    mean = np.r_[np.zeros(n_polynomial), network.into, network.bias, np.zeros(n_hidden * q)]
    last = slice(n_polynomial + 2 * n_hidden, None)
    # Outputs are linear in all weights but the hidden layer's: only those need damping (Ruhe & Wedin 1980, algorithm 2).
    is_hidden = np.zeros(len(precision), dtype=bool)
    is_hidden[n_polynomial : n_polynomial + 2 * n_hidden] = True
    damping, loss, H = 1e-3, np.inf, np.eye(len(precision))
    weights = _weights(network)
    for step_number in range(MAX_STEPS):
        residuals, J = _residuals(network, x, targets, roots), _jacobian(network, x, roots)
        away = weights - mean
        loss = float(residuals @ residuals + away @ (precision * away))
        H = J.T @ J + np.diag(precision)
        g = J.T @ residuals + precision * away
        before, held = loss, np.diag(np.where(is_hidden, np.diag(H), 0.0))
        for _ in range(12):
            step = -np.linalg.solve(H + damping * held, g)
            tried = _network(weights + step, network)
            r = _residuals(tried, x, targets, roots)
            there = weights + step - mean
            tried_loss = float(r @ r + there @ (precision * there))
            if tried_loss < loss:
                network, weights, loss, damping = tried, weights + step, tried_loss, max(damping / 10, 1e-9)
                break
            damping *= 10
        if n_hidden and step_number % EVIDENCE_EVERY == EVIDENCE_EVERY - 1:
            spread = np.linalg.inv(H)[last, last]
            determined = n_hidden * q - precision[-1] * float(np.trace(spread))
            size = float(weights[last] @ weights[last])
            precision[last] = np.clip(determined / max(size, 1e-12), LEAST_PRECISION, MOST_PRECISION)
        elif before - loss < SETTLED * max(before, 1e-12):
            break
    return Fitted(network, loss, _inverse_triangle(network, x, roots, precision))


def _inverse_triangle(
    network: Network,
    x: Float[ndarray, "k"],
    roots: Float[ndarray, "k q q"],
    precision: Float[ndarray, "w"],
) -> Float[ndarray, "w w"]:
    """By a QR factorisation of the derivatives themselves: their square would lose the digits of what is told well."""
    rows = np.concatenate([_jacobian(network, x, roots), np.diag(np.sqrt(precision))])
    scale = 1 / np.linalg.norm(rows, axis=0)
    R = np.linalg.qr(rows * scale, mode="r")
    return scale[:, None] * np.linalg.inv(R)


def _weights(network: Network) -> Float[ndarray, "w"]:
    return np.concatenate([network.polynomial.ravel(), network.into, network.bias, network.out.ravel()])


def _network(weights: Float[ndarray, "w"], like: Network) -> Network:
    ends = np.cumsum([like.polynomial.size, like.into.size, like.bias.size])
    polynomial, into, bias, out = np.split(weights, ends)
    return Network(polynomial.reshape(like.polynomial.shape), into, bias, out.reshape(like.out.shape))


def _derivatives(network: Network, x: float) -> Float[ndarray, "q w"]:
    """Of the outputs by all weights: the error of an output carried back through the layers."""
    q, h = network.polynomial.shape[1], len(network.into)
    hidden = np.tanh(network.into * x + network.bias)
    slope = (1 - hidden**2)[:, None] * network.out
    eye = np.eye(q)
    return np.concatenate(
        [
            np.kron(x ** np.arange(len(network.polynomial)), eye),
            (slope * x).T,
            slope.T,
            np.kron(hidden, eye) if h else np.zeros((q, 0)),
        ],
        axis=1,
    )


def _residuals(
    network: Network, x: Float[ndarray, "k"], targets: Float[ndarray, "k q"], roots: Float[ndarray, "k q q"]
) -> Float[ndarray, "r"]:
    """Whitened differences of the outputs from the targets."""
    outputs = np.stack([network(at) for at in x.tolist()])
    return (roots.swapaxes(-1, -2) @ (outputs - targets)[..., None]).reshape(-1)


def _jacobian(network: Network, x: Float[ndarray, "k"], roots: Float[ndarray, "k q q"]) -> Float[ndarray, "r w"]:
    """Their derivatives by the weights."""
    return np.concatenate([root.T @ _derivatives(network, at) for at, root in zip(x.tolist(), roots, strict=True)])
