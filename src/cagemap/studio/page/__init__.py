"""The page (HTML, JavaScript, three.js), its messages and its server."""
