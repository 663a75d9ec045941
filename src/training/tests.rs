use super::*;
use crate::Silent;

fn recipe(text: &str) -> Result<Recipe> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("recipe.toml");
    std::fs::write(&path, text).unwrap();
    Recipe::load(&path)
}

#[test]
fn a_recipe_is_read_and_bad_ones_name_the_key() {
    let text = "[train]\nepochs = 3\n[[synth]]\nseeds = [4, 5]\nrooms = 1\n[[rgbd]]\nsplit = \"valid\"\nfolder = \"walk\"\n";
    let read = recipe(text).unwrap();
    assert_eq!((read.train.epochs, read.synth[0].seeds.len(), read.rgbd[0].split), (3, 2, Split::Valid));
    let folder = tempfile::tempdir().unwrap();
    let again = folder.path().join("again.toml");
    std::fs::write(&again, read.to_toml().unwrap()).unwrap();
    assert_eq!(Recipe::load(&again).unwrap(), read);

    let message = |text: &str| recipe(text).unwrap_err().to_string();
    let unknown = message("[[synth]]\nseeds = [1]\n[[synth]]\nroom = 2\n");
    assert!(
        unknown.contains("synth[1].room") && unknown.contains("nearest is `synth[1].rooms`"),
        "{unknown}"
    );
    let kind = message("[[rgbd]]\nfolder = 3\n");
    assert!(kind.contains("rgbd[0].folder: found the whole number 3, expected a text"), "{kind}");
    let none = message("[[synth]]\nsplit = \"valid\"\n");
    assert!(none.contains("no training data"), "{none}");
    let step = message("[[rgbd]]\nfragment_step = 0\n");
    assert!(step.contains("rgbd.fragment_step: found 0"), "{step}");
}

/// Recipes that are shipped run, and say everything that decides what comes out.
#[test]
fn every_shipped_recipe_is_read() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("configs/train");
    let mut names: Vec<String> = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        names.push(path.file_name().unwrap().to_string_lossy().into_owned());
        if path.file_name().is_some_and(|n| n == "minispinnet.toml") {
            let recipe = super::descriptor::DescriptorRecipe::load(&path).unwrap();
            assert!(!recipe.synth.is_empty() || !recipe.rgbd.is_empty());
            continue;
        }
        if path.file_name().is_some_and(|n| n == "verifier.toml") {
            let recipe = super::verifier::VerifierRecipe::load(&path).unwrap();
            assert_eq!((recipe.kinds.len(), recipe.descriptor.keypoints.count), (8, 1500));
            continue;
        }
        let recipe = Recipe::load(&path).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(text.contains("[descriptor]\nkind = "), "no descriptor in {}", path.display());
        let splits: Vec<Split> =
            recipe.synth.iter().map(|e| e.split).chain(recipe.rgbd.iter().map(|e| e.split)).collect();
        assert!(splits.contains(&Split::Train) && splits.contains(&Split::Valid), "{}", path.display());
        let seeds: Vec<u64> = recipe.synth.iter().flat_map(|e| e.seeds.clone()).collect();
        let mut distinct = seeds.clone();
        distinct.sort_unstable();
        distinct.dedup();
        assert_eq!(distinct.len(), seeds.len(), "a building of two splits in {}", path.display());
    }
    names.sort();
    assert_eq!(
        names,
        [
            "gem.toml",
            "minispinnet.toml",
            "netvlad-fpfh.toml",
            "netvlad-minispinnet.toml",
            "netvlad.toml",
            "verifier.toml"
        ]
    );
}

/// Two frames of a flat wall 2 m in front of a camera that moves 10 cm to the right: fused in the
/// frame of the second, the wall reaches 10 cm farther to the left.
#[test]
fn frames_are_fused_in_the_camera_of_the_middle_one() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path().join("walk");
    std::fs::create_dir_all(root.join("depth")).unwrap();
    std::fs::write(root.join("K.txt"), "100 100 31.5 23.5").unwrap();
    let mut poses = String::new();
    for i in 0..4 {
        let file = std::fs::File::create(root.join(format!("depth/{i}.png"))).unwrap();
        let mut encoder = png::Encoder::new(file, 64, 48);
        encoder.set_color(png::ColorType::Grayscale);
        encoder.set_depth(png::BitDepth::Sixteen);
        let pixels = [2000u16.to_be_bytes(); 64 * 48].concat();
        encoder.write_header().unwrap().write_image_data(&pixels).unwrap();
        poses.push_str(&format!("1 0 0 {} 0 1 0 0 0 0 1 0 0 0 0 1\n", 0.1 * f64::from(i)));
    }
    std::fs::write(root.join("poses.txt"), poses).unwrap();
    let entry = RgbdEntry {
        folder: "walk".into(),
        first_frame: 1,
        frames_per_fragment: 2,
        fragment_step: 1,
        voxel_m: 0.001,
        ..RgbdEntry::default()
    };
    let posed = fragments::fuse(&entry, folder.path(), &Silent).unwrap();
    assert_eq!(posed.scans.len(), 2);
    assert!((posed.world_from_scan[0].translation.x - 0.2).abs() < 1e-12);
    let x = posed.scans[0].cloud.points.iter().map(|p| p.x);
    let (low, high) = x.fold((f32::MAX, f32::MIN), |(l, h), v| (l.min(v), h.max(v)));
    // Columns −31.5..31.5 at 2 m and f = 100 pixels: ±0.63 m, and 0.1 m more on the left.
    assert!((low + 0.73).abs() < 1e-3 && (high - 0.63).abs() < 1e-3, "{low} {high}");
    let near = RgbdEntry { max_depth_m: 1.0, ..entry.clone() };
    assert!(fragments::fuse(&near, folder.path(), &Silent).unwrap().scans[0].cloud.is_empty());
    let past = RgbdEntry { first_frame: 4, ..entry };
    assert!(
        fragments::fuse(&past, folder.path(), &Silent).err().unwrap().to_string().contains("of 4 frames")
    );
}
