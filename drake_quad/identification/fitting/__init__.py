"""From windows of a log to parameters: models that fly with its commands, and what measurements say of them."""
