"""What a program imports that calls generated C as it calls the generated NumPy module."""

from pfaffian.runtime.code.compiled import compiled_model as compiled_model
