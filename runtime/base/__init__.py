"""What every room stands on: errors, files, TOML, units, the cache and its keys."""
