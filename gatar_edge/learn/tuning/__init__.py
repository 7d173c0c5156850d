"""Fine-tuning on what counts: how long missions take in which a network decides for every robot."""
