"""The newest record, kept whole on disk through crashes and power cuts, and the child that writes it."""
