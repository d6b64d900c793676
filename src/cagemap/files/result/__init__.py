"""Reading and writing of RESULT folders, prepared surfaces and point maps."""
