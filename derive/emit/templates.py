"""Templates filled."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.resources import files

import jinja2
from pfaffian.runtime.base.cache import cache_folder


def _bytecode_cache() -> jinja2.FileSystemBytecodeCache | None:
    """Return a cache of compiled templates, checked against their text; None where it is off."""
    folder = cache_folder()
    if folder is None:
        return None
    try:
        (folder / "templates").mkdir(parents=True, exist_ok=True)
        return jinja2.FileSystemBytecodeCache(str(folder / "templates"))
    except OSError:
        return None


def _environment() -> jinja2.Environment:
    def load(name: str) -> str:
        return files("pfaffian.templates").joinpath(name).read_text(encoding="utf-8")

    return jinja2.Environment(
        loader=jinja2.FunctionLoader(load),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,
        bytecode_cache=_bytecode_cache(),
    )


_ENVIRONMENT = _environment()


def fill(template: str, context: Mapping[str, object]) -> str:
    """Fill `template` (path below `templates/`) with a complete set of keys."""
    return _ENVIRONMENT.get_template(template).render(**context)
