"""The command that shows what the fingers' arrays read: `watch`."""
