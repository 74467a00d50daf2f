"""The network side: requests come in here, and answers and streams leave."""
