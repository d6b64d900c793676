"""Reading and writing of glTF 2.0, including VRM."""
