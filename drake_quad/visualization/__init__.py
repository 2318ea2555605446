"""Pictures of flights."""
