"""A table of a scenario file: every key is known, every value checked, or refused by name."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from pfaffian.runtime.base.errors import InputError
from pfaffian.runtime.base.quantity import parse_quantity
from pfaffian.runtime.base.toml import shown, suggestion


class Table:
    """One table of the document; `where` names file and table in messages."""

    def __init__(self, raw: object, where: str, keys: tuple[str, ...] | None) -> None:
        """Raise `InputError` unless `raw` is a table whose keys are all in `keys`, if given."""
        self.where = where
        self.raw: Mapping[str, Any] = _mapping(raw, where)
        for key in self.raw:
            if keys is not None and key not in keys:
                raise InputError(
                    f"{where}: unknown key {key}", remedy=suggestion(key, list(keys) or ["none"])
                )

    def has(self, key: str) -> bool:
        """Return whether `key` is given."""
        return key in self.raw

    def at(self, key: str) -> str:
        """Return how messages call `key`."""
        return f"{self.where}.{key}"

    def need(self, *keys: str) -> None:
        """Raise `InputError` for the first of `keys` that is missing."""
        for key in keys:
            if key not in self.raw:
                raise InputError(f"{self.where}: missing {key}", remedy=f"add {key}")

    def quantity(
        self,
        key: str,
        unit: str,
        default: float,
        least: float = -math.inf,
        most: float = math.inf,
        *,
        above: bool = False,
    ) -> float:
        """Return the value of `key` in `unit`, from `least` to `most`; `above` excludes `least`."""
        if key not in self.raw:
            return default
        value = parse_quantity(self.raw[key], unit, self.at(key))
        if value < least or value > most or (above and value == least):
            low = f"above {least:g}" if above else f"from {least:g}"
            high = f" to {most:g}" if math.isfinite(most) else ""
            raise InputError(
                f"{self.at(key)} = {value:g} is out of its bounds",
                remedy=f"give a value {low}{high}{' ' + unit if unit else ''}",
            )
        return value

    def whole(self, key: str, default: int, least: int, most: int) -> int:
        """Return the whole number at `key`."""
        value = self.raw.get(key, default)
        if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
            raise InputError(
                f"{self.at(key)} = {shown(value)} is no whole number from {least} to {most}",
                remedy=f"give {least} to {most}",
            )
        return value

    def choice(self, key: str, known: tuple[str, ...], default: str = "") -> str:
        """Return the word at `key`, one of `known`."""
        value = self.raw.get(key, default)
        if value not in known:
            word = value if isinstance(value, str) else shown(value)
            raise InputError(
                f"{self.at(key)} = {shown(value)} is unknown",
                remedy=suggestion(word, list(known)),
            )
        return str(value)

    def text(self, key: str) -> str:
        """Return the string at `key`, empty without one."""
        value = self.raw.get(key, "")
        if not isinstance(value, str):
            raise InputError(f"{self.at(key)} must be a string", remedy=f'write {key} = "..."')
        return value

    def part(self, key: str, keys: tuple[str, ...] | None) -> Table:
        """Return the table at `key`, empty without one."""
        return Table(self.raw.get(key, {}), self.at(key), keys)

    def rows(self, key: str, keys: tuple[str, ...]) -> list[Table]:
        """Return the tables of the array at `key`, numbered from 1 in messages."""
        raw = self.raw.get(key, [])
        if not isinstance(raw, list):
            raise InputError(
                f"{self.at(key)} must be an array of tables", remedy=f"write [[twin.{key}]] above"
            )
        return [Table(row, f"{self.at(key)}[{k}]", keys) for k, row in enumerate(raw, 1)]


def _mapping(raw: object, where: str) -> Mapping[str, Any]:
    if not isinstance(raw, dict):
        raise InputError(
            f"{where} must be a table", remedy=f"write [{where.split(': ')[-1]}] above it"
        )
    return raw
