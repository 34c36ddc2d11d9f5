"""One module per `treadlight` command: reads, calls the stage's functions, writes."""
