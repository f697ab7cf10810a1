"""Generated code behind Python objects: models, controllers, batches, firmware."""
