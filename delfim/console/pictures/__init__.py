"""Pictures of boats' cameras: asked for at the rate that the link leaves, and of recordings by their time."""
