"""Is a map without landmarks right where it is said to be sure? All ordered pairs of all meshes, absurd ones too."""
