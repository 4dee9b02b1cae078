"""The gateway between the boats and the pages in browsers, and the watch that it keeps."""
