"""Campaigns: many runs in lock step that differ in what a file varies, and their results (docs/campaigns.md)."""
