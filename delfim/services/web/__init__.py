"""What httpd shows: the words of its interface, sections, figures and metrics, as pure functions; and the page's own files."""
