//! USD: layers by hand, what is refused, what is in an archive.

use crate::common::{labelled, write};
use scenesplat_scene::{
    GaussianScene, LoadedScene, ReadOptions, SceneError, SceneFormat, open_scene_bytes,
};
use std::io::{Cursor, Write};
use std::path::Path;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

fn read(text: impl AsRef<[u8]>) -> Result<LoadedScene, SceneError> {
    open_scene_bytes(text.as_ref(), Path::new("a.usda"), &ReadOptions::default())
}

fn near(found: [f32; 3], due: [f64; 3]) -> bool {
    found.iter().zip(due).all(|(a, b)| (f64::from(*a) - b).abs() < 1e-6)
}

/// Two Gaussians below a prim that moves them, as other programs may write them.
const BY_HAND: &str = r#"#usda 1.0
(
    "from a scan"
    customLayerData = { string note = "no } prim" }
    metersPerUnit = 0.01
    subLayers = [@other.usda@]
    upAxis = "Z"
)
# def ParticleField3DGaussianSplat "NotThis" {}
class "Base" { def ParticleField3DGaussianSplat "NorThis" { point3f[] positions = [(0, 0, 0)] } }
def Xform "World" (
    kind = "component"
)
{
    def ParticleField3DGaussianSplat "Splats" (
        prepend apiSchemas = ["SkelBindingAPI"]
    )
    {
        half3[] scalesh = [(1, 1, 1), (2, 2, 4)]
        float3[] extent = [(0, 0, 0), (1, 1, 1)]
        point3f[] positions = [(100, 0, 0), (0, 200, 0.5),]
        quatf[] orientations = [(1, 0, 0, 0), (0.5, 0.5, 0.5, 0.5)]
        float[] opacities = [0.5, 1]
        float[] opacities.timeSamples = { 0: [0.5, 1] }
        uniform int radiance:sphericalHarmonicsDegree = 1
        float3[] radiance:sphericalHarmonicsCoefficients = [
            (1, 2, 3), (0.1, 0, 0), (0.2, 0, 0), (0.3, 0, 0),
            (4, 5, 6), (0, 0, 0), (0, 0, 0), (0, 0, 0)
        ]
        int[] primvars:segment = [7, -5] (interpolation = "vertex")
        float[] primvars:heat = [1, 2] (
            interpolation = "vertex"
        )
        rel material:binding = </World/Looks>
        token visibility = "inherited"
        color3f[] primvars:displayColor = None
    }
    double3 xformOp:translate:pivot = (0, 0, 10)
    float3 xformOp:rotateXYZ = (0, 0, 90)
    uniform token[] xformOpOrder = ["xformOp:translate:pivot", "xformOp:rotateXYZ"]
}
def Mesh "Other" (
    prepend references = [@a@</Scene> (offset = 1), @@@c@d.usda@@@]
    payload = @e.usdc@</Scene> (offset = 2)
)
{
    asset texture = @wood.png@
    double3 xformOp:translate.timeSamples = { 0: (0, 0, 0), 1: (1, 0, 0) }
    uniform token[] xformOpOrder = ["xformOp:translate", "!invert!xformOp:rotateX:nowhere"]
}
def ParticleField3DGaussianSplat "Off" (active = false)
{
    point3f[] positions = [(0, 0, 0)]
}
reorder rootPrims = ["Other", "World"]
"#;

#[test]
fn a_layer_by_hand_is_where_it_says() {
    let loaded = read(BY_HAND).unwrap();
    let scene = &loaded.scene;
    // (100, 0, 0) turned about z is (0, 100, 0), then lifted by 10: forward and up, in centimeters. Up is −y here.
    assert!(near(scene.coord[0], [0.0, -0.1, 1.0]), "{:?}", scene.coord);
    assert!(near(scene.coord[1], [-2.0, -0.105, 0.0]), "{:?}", scene.coord);
    let sizes = [0, 1].map(|row| scene.log_scale[row].map(|v| f64::from(v).exp() as f32));
    assert!(near(sizes[0], [0.01; 3]) && near(sizes[1], [0.02, 0.02, 0.04]), "{sizes:?}");
    assert_eq!((scene.opacity_logit[0], scene.opacity_logit[1]), (0.0, f32::INFINITY));
    assert_eq!(scene.sh_dc, [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]);
    assert_eq!((scene.sh_degree, scene.sh_rest.len()), (1, 18));
    // Of degree 1 the red coefficients are a vector (−y, z, −x of the light); it has turned with the scene.
    let red = |k: usize| scene.sh_rest[3 * k];
    let light = [-red(2), -red(0), red(1)];
    // In the layer it is (−0.3, −0.1, 0.2), turned about z (0.1, −0.3, 0.2); right, down, forward that is:
    assert!(near(light, [0.1, -0.2, -0.3]), "{light:?}");
    assert_eq!(scene.segment, Some(vec![7, -1]));
    // The principal axes: the second Gaussian's z is the prim's x, which is forward now.
    let [w, x, y, z] = scene.quat[1];
    let third = [2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)];
    assert!(near(third.map(f32::abs), [0.0, 0.0, 1.0]), "{third:?}");
    let unread: Vec<_> = loaded.unread.iter().map(|c| (c.name.as_str(), c.kind.as_str())).collect();
    assert_eq!(
        unread,
        [("primvars:heat", "float[]"), ("opacities.timeSamples", "changes with time")]
    );
    for said in ["metersPerUnit = 0.01", "refers to other files"] {
        assert!(loaded.report.notes.iter().any(|note| note.contains(said)), "{said}");
    }
    // The same, written otherwise.
    let pivot = "xformOpOrder = [\"xformOp:translate:pivot\", ";
    let back = "\"!invert!xformOp:translate:pivot\", \"xformOp:translate:pivot\", ";
    for (from, to) in [
        (" = ", "="),
        (pivot, &format!("{pivot}{back}")),
        (pivot, &pivot.replace('[', "[\"!resetXformStack!\", ")),
        ("opacities = [0.5, 1]\n", "opacities = [0.5, 1.0000001]\n"),
    ] {
        assert!(BY_HAND.contains(from), "{from}");
        assert_eq!(read(BY_HAND.replace(from, to)).unwrap().scene, *scene, "{to}");
    }
}

#[test]
fn what_a_layer_leaves_open_is_said() {
    let text =
        "#usda 1.0\ndef ParticleField3DGaussianSplat \"A\" { point3h[] positionsh = [(1, 2, 3)] }";
    let loaded = read(text).unwrap();
    let scene = &loaded.scene;
    // USD prescribes centimeters where a layer does not say.
    assert!(near(scene.coord[0], [0.01, -0.02, -0.03]));
    assert!(near(scene.log_scale[0], [0.01_f64.ln(); 3]));
    assert_eq!((scene.quat[0], scene.opacity_logit[0]), ([1.0, 0.0, 0.0, 0.0], f32::INFINITY));
    assert_eq!((scene.sh_dc[0], scene.sh_degree), ([0.0; 3], 0));
    for said in ["metersPerUnit", "no scales", "no orientations", "no opacities", "no radiance:"] {
        assert!(
            loaded.report.notes.iter().any(|note| note.contains(said)),
            "{:?}",
            loaded.report.notes
        );
    }
}

#[test]
fn what_cannot_be_read_is_refused() {
    for (from, to, said) in [
        (
            "def Xform",
            "over",
            "holds no ParticleField3DGaussianSplat itself; it refers to other files or prims",
        ),
        ("class \"Base\"", "def \"Base\"", "holds 2 prims"),
        ("float[] opacities =", "float[] other =", ""),
        ("[0.5, 1]\n", "[0.5]\n", "opacities has 1 values, 2 for 2 Gaussians"),
        ("sphericalHarmonicsDegree = 1", "sphericalHarmonicsDegree = 2", "has 8 values, 18 for"),
        ("sphericalHarmonicsDegree = 1", "sphericalHarmonicsDegree = 5", "degree 5"),
        ("sphericalHarmonicsDegree = 1", "sphericalHarmonicsDegree = -1", "expected a number"),
        ("upAxis = \"Z\"", "upAxis = \"X\"", "upAxis = \"X\""),
        ("metersPerUnit = 0.01", "metersPerUnit = 0", "metersPerUnit = 0"),
        ("metersPerUnit = 0.01", "metersPerUnit = -1", "metersPerUnit = -1"),
        (
            "xformOp:rotateXYZ",
            "xformOp:rotateXXZ",
            "/World is moved by xformOp:rotateXXZ, which is not read",
        ),
        (
            "pivot = (0, 0, 10)",
            "pivot.timeSamples = {0: (0, 0, 10)}",
            "pivot, which changes with time",
        ),
        (
            "pivot = (0, 0, 10)",
            "pivot = (0, 0, 10) double3 xformOp:translate:pivot.connect = </A.b>",
            "changes with time",
        ),
        ("int[] primvars:segment", "float[] primvars:segment", ""),
        ("(100, 0, 0)", "(100, 0)", "line 21: expected ','"),
        ("point3f[] positions =", "point3f[] places =", "has no positions"),
        (
            "point3f[] positions = [(100, 0, 0), (0, 200, 0.5),]",
            "point3f[] positions.timeSamples = {0: [(1, 0, 0)]}",
            "changes with time, which is not read",
        ),
        ("(0, 0, 90)", "(0, 0, 1e999999)", "without inverse"),
        ("[7, -5]", "[7.5, -5]", "expected a number"),
        ("</World/Looks>", "</World/Looks", "line"),
    ] {
        assert!(BY_HAND.contains(from), "{from}");
        let found = read(BY_HAND.replacen(from, to, if from.starts_with("[0.5") { 1 } else { 9 }));
        let found = found.map(|loaded| loaded.scene.len());
        match said {
            "" => assert_eq!(found.unwrap(), 2),
            said => {
                let found = found.unwrap_err().to_string();
                assert!(found.contains(said) && found.contains("a.usda"), "{from} → {to}: {found}");
            }
        }
    }
    // Cut anywhere, and with any byte changed, it is read or refused.
    for end in 5..BY_HAND.len() {
        let _ = read(&BY_HAND.as_bytes()[..end]);
        let mut changed = BY_HAND.as_bytes().to_vec();
        changed[end] ^= 0x15;
        let _ = read(changed);
    }
    let deep = format!("#usda 1.0\n{}", "def \"a\" {".repeat(100_000));
    let found = read(deep).unwrap_err().to_string();
    assert!(found.contains("nested deeper") || found.contains("the file ends"), "{found}");
    assert!(read("PXR-USDC").unwrap_err().to_string().contains("usdcat"));
}

#[test]
fn archives_hold_their_text_at_a_multiple_of_64() {
    let folder = tempfile::tempdir().unwrap();
    let scene = labelled(300, 2);
    let [text, archive] = ["a.usda", "a.usdz"].map(|name| folder.path().join(name));
    write(&scene, &text, SceneFormat::Usda);
    write(&scene, &archive, SceneFormat::Usdz);
    let [text, archive] = [text, archive].map(|path| std::fs::read(path).unwrap());
    let at = archive.windows(text.len()).position(|part| part == text).unwrap();
    assert_eq!(at % 64, 0);
    let pack = |name: &str, bytes: &[u8], method| {
        let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
        zip.start_file(name, SimpleFileOptions::default().compression_method(method)).unwrap();
        zip.write_all(bytes).unwrap();
        zip.finish().unwrap().into_inner()
    };
    let stored = read(pack("b.usda", &text, CompressionMethod::Stored)).unwrap();
    assert_eq!(stored.kind, SceneFormat::Usdz);
    assert_eq!(stored.scene, read(&text).unwrap().scene);
    for (name, bytes, method, said) in [
        ("b.usdc", b"PXR-USDC\0".to_vec(), CompressionMethod::Stored, "binary USD"),
        ("b.usda", text, CompressionMethod::Deflated, "compressed"),
    ] {
        let found = read(pack(name, &bytes, method)).unwrap_err().to_string();
        assert!(found.contains(said), "{found}");
    }
    for end in (4..archive.len()).step_by(997) {
        assert!(read(&archive[..end]).is_err());
    }
}

#[test]
fn labels_are_primvars_with_a_value_each() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.usda");
    let scene: GaussianScene = labelled(5, 0);
    write(&scene, &path, SceneFormat::Usda);
    let text = std::fs::read_to_string(&path).unwrap();
    let values: Vec<String> = scene.segment.unwrap().iter().map(i32::to_string).collect();
    let due = format!(
        "int[] primvars:segment = [{}] (\n        interpolation = \"vertex\"",
        values.join(", ")
    );
    assert!(text.contains(&due), "{text}");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "no labels beside the scene");
}
