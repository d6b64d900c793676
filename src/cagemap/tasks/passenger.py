"""`cagemap transfer --passenger`: a mesh that sits on the source's body, moved to the target's."""

from __future__ import annotations

from typing import cast

from cagemap.character.passenger_pieces import PassengerKind
from cagemap.character.passengers import carry_passenger
from cagemap.files.atomic import check_outputs
from cagemap.files.meshes.formats import check_mesh_path, mesh_files, read_mesh, write_mesh
from cagemap.files.result.folder import note_transfer, stated_path
from cagemap.maps.result import MatchResult
from cagemap.tasks.progress import Outcome, Stages
from cagemap.tasks.requests.transfer import TransferRequest

# A passenger further from the body than this on average, of sqrt(area), has probably other units or another place.
_APART = 0.5


def transfer_passenger(request: TransferRequest, result: MatchResult, stages: Stages) -> Outcome:
    """Clothes, eyes, hair or a prop; UVs and materials stay as they are."""
    assert request.passenger is not None
    check_mesh_path(request.output)
    mesh = read_mesh(request.passenger)
    check_outputs(mesh_files(request.output, mesh), [request.passenger], force=request.force)
    stages("passenger")
    carried = carry_passenger(result, mesh, kind=cast(PassengerKind | None, request.kind))
    write_mesh(request.output, mesh.with_positions(carried.positions), like=request.passenger, force=request.force)
    files = {"file": request.passenger, "output": request.output}
    entry = {"kind": "passenger"} | {name: stated_path(path, request.result) for name, path in files.items()}
    note_transfer(request.result, entry)
    warnings = []
    if carried.distance > _APART:
        warnings.append(
            f"{request.passenger} is {carried.distance:.1f} body sizes away from "
            f"{result.source.control.name} on average: check that both have the same units and place"
        )
    return f"wrote {request.output}: {mesh.n_vertices} vertices on {result.target.control.name}", warnings
