"""What a section of the paper comes to, and how its figures are drawn."""
