"""Commands about a model: what is known, derived, designed, planned and certified."""
