from typing import Any

CORNER_RESULT_SIZE: int
N_OBSERVED: int
N_RING: int
POOLED_CORNER_SIZE: int

def __getattr__(name: str) -> Any: ...
