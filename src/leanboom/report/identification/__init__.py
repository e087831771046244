"""What is written of an identification: its page and the files beside it."""
