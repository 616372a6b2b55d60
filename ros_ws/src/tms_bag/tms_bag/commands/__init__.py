"""The commands of `bag`, one module each."""
