"""Where there is no flying: solid obstacles, and the room between them."""
