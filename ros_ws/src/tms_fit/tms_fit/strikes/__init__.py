"""Strike detection, classification, strike time and window end."""
