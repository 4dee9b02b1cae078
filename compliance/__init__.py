"""What rules ask for, and what Delfim says to it: the records of docs/compliance.md."""
