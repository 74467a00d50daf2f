"""The network side: it takes requests and sends answers and streams."""
