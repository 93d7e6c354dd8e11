"""One file a format → `Recording`."""
