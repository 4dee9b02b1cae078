"""The watch: alerts, operators, who commands."""
