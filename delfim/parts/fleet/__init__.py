"""The boat at an MQTT broker."""
