"""Plain YAML: no aliases, so that a small text stays small, and one kind of error whatever is wrong with it."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any

_INTEGER = "tag:yaml.org,2002:int"
Constructor = Callable[[Mapping[Any, Any]], Any]


def parse_yaml(text: str, tagged_mappings: Mapping[str, Constructor] | None = None) -> Any:
    """The value of a YAML text; ``tagged_mappings`` makes values of mappings that bear one of its tags.

    Aliases are refused: no file that binocal reads has a use for them, and ten lines of them make a value without end.

    Raises:
        ValueError: It is not plain YAML; the text says where, in one line.
    """
    import yaml
    from yaml.composer import ComposerError
    from yaml.constructor import ConstructorError

    class Loader(yaml.SafeLoader):
        """SafeLoader without aliases and without keys that stand twice, of which it would take the last in silence."""

        def compose_node(self, parent: Any, index: Any) -> Any:
            if self.check_event(yaml.AliasEvent):
                raise ComposerError(None, None, "it holds an alias (*name)", self.peek_event().start_mark)
            return super().compose_node(parent, index)

        def construct_mapping(self, node: Any, deep: bool = False) -> Any:
            seen = set()
            for key, _ in node.value:
                if isinstance(key, yaml.ScalarNode):
                    if key.value in seen:
                        raise ConstructorError(None, None, f"it holds {key.value[:40]!r} twice", key.start_mark)
                    seen.add(key.value)
            return super().construct_mapping(node, deep)

    # whole numbers are decimal: 0x14, 010 or 1:30 would be other numbers than a reader sees
    Loader.yaml_implicit_resolvers = {
        first: [(tag, form) for tag, form in forms if tag != _INTEGER]
        for first, forms in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }
    Loader.add_implicit_resolver(_INTEGER, re.compile(r"[-+]?(?:0|[1-9][0-9]*)$"), list("-+0123456789"))

    def constructor(construct: Constructor) -> Callable[[Any, Any], Any]:
        return lambda loader, node: construct(loader.construct_mapping(node, deep=True))

    for tag, construct in (tagged_mappings or {}).items():
        Loader.add_constructor(tag, constructor(construct))
    try:
        return yaml.load(text, Loader)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None
    except yaml.YAMLError as error:
        raise ValueError(_sentence(error)) from None
    except (ValueError, ArithmeticError, LookupError, TypeError, AttributeError):
        # what PyYAML's conversions let pass: their words are about Python, not about the file
        raise ValueError(
            "a number, date or other tagged value in it is ill-formed, or has thousands of digits"
        ) from None


def _sentence(error: Exception) -> str:
    """What is wrong, and where: PyYAML's own text names a "unicode string" for the file and draws the line below it."""
    problem, mark = getattr(error, "problem", None), getattr(error, "problem_mark", None)
    words = " ".join(str(problem or error).split())[:200] or type(error).__name__
    return words if mark is None else f"{words}, in line {mark.line + 1}, column {mark.column + 1}"
