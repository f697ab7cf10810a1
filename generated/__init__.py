"""Generated code, one folder a model. Never edited by hand: `pfaffian generate MODEL` writes it."""
