"""Every function of binocal checks the types, shapes and dtypes that it states while the tests run.

jaxtyping's import hook decorates each function and dataclass with ``jaxtyping.jaxtyped``. What is called most is checked the
first hundred times and every fiftieth time after that: a check takes some 50 microseconds, more than most of these functions.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from typing import Any

import jaxtyping
from beartype import BeartypeConf, beartype

CHECKED_AT_FIRST = 100
THEN_EVERY = 50

# An int where a float is stated is fine, as it is for type checkers (PEP 484).
checked = beartype(conf=BeartypeConf(is_pep484_tower=True))


class Sampling:
    """Whether calls are sampled; tests of the checks themselves want each call checked."""

    is_on = True


_jaxtyped = jaxtyping.jaxtyped


def _sampled(plain: Callable[..., Any], decorate: Callable[[], Callable[..., Any]]) -> Callable[..., Any]:
    """``plain`` with its first calls checked, then every some; ``decorate`` makes the checking form when it is first needed."""
    n_calls, checking = 0, None

    @functools.wraps(plain)
    def call(*args: Any, **kwargs: Any) -> Any:
        nonlocal n_calls, checking
        n_calls += 1
        if n_calls <= CHECKED_AT_FIRST or n_calls % THEN_EVERY == 0 or not Sampling.is_on:
            if checking is None:
                checking = decorate()
            return checking(*args, **kwargs)
        return plain(*args, **kwargs)

    return call


def jaxtyped(*, typechecker: Any) -> Callable[[Any], Any]:
    """``jaxtyping.jaxtyped`` with sampled calls."""

    def decorate(target: Any) -> Any:
        if inspect.isclass(target):
            plain = target.__init__
            decorated = _jaxtyped(typechecker=typechecker)(target)
            if decorated.__init__ is not plain:
                checking = decorated.__init__
                decorated.__init__ = _sampled(plain, lambda: checking)
            return decorated
        if not inspect.isfunction(target):
            return _jaxtyped(typechecker=typechecker)(target)
        return _sampled(target, lambda: _jaxtyped(typechecker=typechecker)(target))

    return decorate


def install(modules: list[str]) -> None:
    """Checks those modules of binocal, and all below them, when they are imported."""
    jaxtyping.jaxtyped = jaxtyped
    jaxtyping.install_import_hook(modules, "shape_checks.checked")
