"""The pages of httpd: the report's types, sections, figures, metrics, as pure functions; and the page's own files."""
