"""Charts behind the map: images and tiles, and where on Earth their pixels lie."""
