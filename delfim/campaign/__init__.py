"""Campaigns: many runs in lock step that differ in what a file says, and what came of them (docs/campaigns.md)."""
