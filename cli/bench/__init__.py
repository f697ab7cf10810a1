"""Commands that measure: `pfaffian bench`."""
