"""The contract between generated code and whoever runs it: manifest and memory layouts."""
