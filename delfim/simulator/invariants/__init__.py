"""What must always be so of a boat in lock step, a file a subject, written from the documents and not from its program."""
