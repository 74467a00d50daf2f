"""The wire contract between host and target: keys, messages, codec and errors. No I/O."""
