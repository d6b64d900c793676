"""Values at vertices, faces and corners in files: attributes, weights, shapes, joints."""
