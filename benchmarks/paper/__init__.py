"""The paper's figures and tables, redrawn from our data: protocol C."""
