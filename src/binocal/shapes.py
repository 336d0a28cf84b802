"""Array types with shapes, ``Float[ndarray, "n 2"]``: jaxtyping's, loaded when an annotation is first evaluated.

Type checkers see jaxtyping itself, ``typing.get_type_hints`` and run-time checkers get its types. An annotation that nobody
evaluates costs nothing: jaxtyping takes 50 ms to import, more than everything else that ``import binocal`` loads.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Float32, Int, Shaped, UInt, UInt8, UInt16
else:

    class _Lazy:
        """Stands for one of jaxtyping's types until it is subscripted."""

        __slots__ = ("_name",)

        def __init__(self, name: str) -> None:
            self._name = name

        def __getitem__(self, item: tuple[type, str]) -> Any:
            import jaxtyping
            import numpy as np

            array_type, shape = item
            kind = getattr(jaxtyping, self._name)
            if array_type is np.ndarray and shape.startswith(("*", "...")) and len(shape.split()) == 1:
                # NumPy's functions return a scalar (np.float64) for an array without axes.
                return kind[array_type, shape] | kind[np.generic, shape]
            return kind[array_type, shape]

        def __repr__(self) -> str:
            return f"jaxtyping.{self._name}"

    Bool, Float, Float32, Int, Shaped, UInt, UInt8, UInt16 = (
        _Lazy(name) for name in ("Bool", "Float", "Float32", "Int", "Shaped", "UInt", "UInt8", "UInt16")
    )

__all__ = ["Bool", "Float", "Float32", "Int", "Shaped", "UInt", "UInt8", "UInt16"]
