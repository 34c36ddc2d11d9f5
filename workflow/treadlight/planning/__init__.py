"""What the workflow needs to know before any stage runs: config, digests, what is refused."""
