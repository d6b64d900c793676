"""The RESULT folder of a match, stored surfaces and point maps."""
