//! GLB: binary glTF 2.0 (Khronos Group, "glTF 2.0 Specification", 2021), for viewers and browsers. Written only.

use std::{io::Write, path::Path};

use uw_cloud::{Frame, TriangleMesh};

use crate::atomic::{self, Overwrite};
use crate::error::Error;

/// `glTF`, `JSON` and `BIN\0` as the format's numbers.
const MAGIC: u32 = 0x4654_6c67;
const JSON: u32 = 0x4e4f_534a;
const BINARY: u32 = 0x004e_4942;

const MM_PER_M: f64 = 1000.0;

/// Writes a mesh as one node: positions as floats about the mesh's own middle, so that they keep their digits, triangles, and normals
/// where it has them. The node's matrix makes metres of them and turns y up, as glTF has it: the camera's y points down, and z away.
///
/// # Errors
/// As [`atomic::write`].
pub fn write(path: &Path, overwrite: Overwrite, mesh: &TriangleMesh) -> Result<(), Error> {
    let (low, high) = mesh.bounding_box_mm().unwrap_or_default();
    let middle: [f64; 3] = std::array::from_fn(|k| 0.5 * (low[k] + high[k]));
    let vertices = mesh.vertices_mm().len();
    let normals = mesh.normals().filter(|normals| normals.iter().all(|n| n.iter().any(|c| *c != 0.0)));
    let local = |p: &[f64; 3]| -> [f32; 3] { std::array::from_fn(|k| (p[k] - middle[k]) as f32) };
    let corners = [low, high].map(|corner| local(&corner).map(|c| format!("{c:?}")).join(","));
    let (indices_bytes, vertices_bytes) = (12 * mesh.triangles().len(), 12 * vertices);
    let binary = indices_bytes + vertices_bytes * if normals.is_some() { 2 } else { 1 };
    let normals_view = format!(
        r#",{{"buffer":0,"byteOffset":{},"byteLength":{vertices_bytes},"target":34962}}"#,
        indices_bytes + vertices_bytes
    );
    let normals_accessor =
        format!(r#",{{"bufferView":2,"componentType":5126,"count":{vertices},"type":"VEC3"}}"#);
    let on = |text: &str| if normals.is_some() { text.to_owned() } else { String::new() };
    let mut json = format!(
        concat!(
            r#"{{"asset":{{"version":"2.0","generator":"uwscan {version}"}},"scene":0,"scenes":[{{"nodes":[0]}}],"#,
            r#""nodes":[{{"mesh":0,"name":"surface","matrix":{matrix}}}],"#,
            r#""meshes":[{{"primitives":[{{"attributes":{{"POSITION":1{normal}}},"indices":0,"material":0}}]}}],"#,
            r#""materials":[{{"doubleSided":true,"pbrMetallicRoughness":{{"baseColorFactor":[0.75,0.75,0.72,1],"#,
            r#""metallicFactor":0,"roughnessFactor":0.8}}}}],"#,
            r#""buffers":[{{"byteLength":{binary}}}],"bufferViews":["#,
            r#"{{"buffer":0,"byteOffset":0,"byteLength":{indices_bytes},"target":34963}},"#,
            r#"{{"buffer":0,"byteOffset":{indices_bytes},"byteLength":{vertices_bytes},"target":34962}}{view}],"accessors":["#,
            r#"{{"bufferView":0,"componentType":5125,"count":{indices},"type":"SCALAR"}},"#,
            r#"{{"bufferView":1,"componentType":5126,"count":{vertices},"type":"VEC3","min":[{low}],"max":[{high}]}}{accessor}]}}"#
        ),
        version = env!("CARGO_PKG_VERSION"),
        matrix = matrix(mesh.frame(), middle),
        normal = on(r#","NORMAL":2"#),
        binary = binary,
        indices_bytes = indices_bytes,
        vertices_bytes = vertices_bytes,
        view = on(&normals_view),
        indices = 3 * mesh.triangles().len(),
        vertices = vertices,
        low = corners[0],
        high = corners[1],
        accessor = on(&normals_accessor),
    );
    // A chunk ends on a multiple of four bytes; that of the numbers does of itself.
    json.extend(std::iter::repeat_n(' ', json.len().next_multiple_of(4) - json.len()));
    let total = 12 + 8 + json.len() + 8 + binary;
    let Ok(total) = u32::try_from(total) else {
        let what = format!("the mesh takes {total} bytes, and a GLB has at most {}", u32::MAX);
        return Err(Error::content(crate::error::Place::file(path), what, "write a .ply"));
    };
    atomic::write(path, overwrite, |w| {
        let word = |w: &mut dyn Write, value: u32| w.write_all(&value.to_le_bytes());
        [MAGIC, 2, total, json.len() as u32, JSON].into_iter().try_for_each(|value| word(w, value))?;
        w.write_all(json.as_bytes())?;
        [binary as u32, BINARY].into_iter().try_for_each(|value| word(w, value))?;
        mesh.triangles().iter().flatten().try_for_each(|v| word(w, *v))?;
        mesh.vertices_mm().iter().flat_map(local).try_for_each(|c| w.write_all(&c.to_le_bytes()))?;
        normals.unwrap_or_default().iter().flatten().try_for_each(|c| w.write_all(&c.to_le_bytes()))
    })
}

/// The node's matrix, column by column.
fn matrix(frame: Frame, middle: [f64; 3]) -> String {
    let scale = 1.0 / MM_PER_M;
    let [x, y, z] = middle.map(|c| c / MM_PER_M);
    let columns = match frame {
        // Half a turn about x.
        Frame::Camera => [scale, 0.0, 0.0, 0.0, 0.0, -scale, 0.0, 0.0, 0.0, 0.0, -scale, 0.0, x, -y, -z, 1.0],
        Frame::Galvo => [scale, 0.0, 0.0, 0.0, 0.0, scale, 0.0, 0.0, 0.0, 0.0, scale, 0.0, x, y, z, 1.0],
    };
    format!("[{}]", columns.map(|c| c.to_string()).join(","))
}
