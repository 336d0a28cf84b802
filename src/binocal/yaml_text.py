"""Plain YAML: no aliases, so that a small text stays small, and one kind of error whatever is wrong with it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

Constructor = Callable[[Mapping[Any, Any]], Any]


def parse_yaml(text: str, tagged_mappings: Mapping[str, Constructor] | None = None) -> Any:
    """The value of a YAML text; ``tagged_mappings`` makes values of mappings that bear one of its tags.

    Aliases are refused: no file that binocal reads has a use for them, and ten lines of them make a value without end.

    Raises:
        ValueError: It is not plain YAML; the text says where, in one line.
    """
    import yaml
    from yaml.composer import ComposerError

    class Loader(yaml.SafeLoader):
        """SafeLoader without aliases."""

        def compose_node(self, parent: Any, index: Any) -> Any:
            if self.check_event(yaml.AliasEvent):
                raise ComposerError(None, None, "it holds an alias (*name)", self.peek_event().start_mark)
            return super().compose_node(parent, index)

    def constructor(construct: Constructor) -> Callable[[Any, Any], Any]:
        return lambda loader, node: construct(loader.construct_mapping(node, deep=True))

    for tag, construct in (tagged_mappings or {}).items():
        Loader.add_constructor(tag, constructor(construct))
    try:
        return yaml.load(text, Loader)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None
    except (yaml.YAMLError, ValueError, ArithmeticError, LookupError, TypeError, AttributeError) as error:
        # PyYAML lets pass what its conversions of ill-formed numbers, dates and binary data raise
        raise ValueError(" ".join(str(error).split())[:200] or type(error).__name__) from None
