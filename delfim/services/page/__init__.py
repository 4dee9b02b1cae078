"""The pages of httpd: the words of its interface, sections, figures, metrics, as pure functions; and the page's own files."""
