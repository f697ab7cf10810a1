"""Design of gains: figures of a parameter set, poles, Riccati row, trade-off, intervals."""

from pfaffian.derive.design.assess import Design, assess, singular_distance

__all__ = ["Design", "assess", "singular_distance"]
