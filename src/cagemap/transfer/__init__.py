"""Transfer: textures, displacement and attributes, pulled back from source to target through the point map."""
