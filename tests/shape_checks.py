"""Every function of binocal checks the types, shapes and dtypes that it states while the tests run."""

from beartype import BeartypeConf, beartype

# An int where a float is stated is fine, as it is for type checkers (PEP 484).
checked = beartype(conf=BeartypeConf(is_pep484_tower=True))
