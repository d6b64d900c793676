"""Reading and writing of values at vertices, faces and corners: attributes, weights, shapes, joints."""
