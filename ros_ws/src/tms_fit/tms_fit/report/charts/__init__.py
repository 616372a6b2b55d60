"""What the report draws of one strike, in reading order, and of all strikes together."""
