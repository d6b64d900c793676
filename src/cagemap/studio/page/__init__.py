"""The page (HTML, JavaScript, three.js), what it is told, what it may ask for, and the server for both."""
