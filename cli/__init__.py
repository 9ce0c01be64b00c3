"""The command line. It also connects rigs with the diagnosis (`cli.investigate`)."""
