//! Rendering of SVG figures as PNG, with twice their width and height in pixels. The program contains the font, so that
//! the result does not depend on the machine's fonts.

use std::sync::{Arc, LazyLock};

use resvg::tiny_skia::{Pixmap, Transform};
use resvg::usvg::{Options, Tree, fontdb};

/// Font Roboto Regular (Apache License 2.0, see `assets/fonts`).
static FONT: &[u8] = include_bytes!("../../assets/fonts/Roboto-Regular.ttf");
/// Scale from an SVG figure to its PNG: pixels of the PNG for each pixel of the figure, in width and in height.
const SCALE: f32 = 2.0;

static FONTS: LazyLock<Arc<fontdb::Database>> = LazyLock::new(|| {
    let mut fonts = fontdb::Database::new();
    fonts.load_font_data(FONT.to_vec());
    fonts.set_sans_serif_family("Roboto");
    Arc::new(fonts)
});

/// Error: a figure cannot be rendered as PNG; its text is the reason.
#[derive(Debug, thiserror::Error)]
#[error("cannot draw a figure as PNG: {0}")]
pub struct PngError(String);

/// Renders an SVG figure and returns the bytes of a PNG file with twice its width and height.
pub fn render(svg: &str) -> Result<Vec<u8>, PngError> {
    let wrong = |what: String| PngError(what);
    let options = Options { fontdb: Arc::clone(&FONTS), font_family: "Roboto".to_owned(), ..Options::default() };
    let tree = Tree::from_str(svg, &options).map_err(|e| wrong(e.to_string()))?;
    let size = tree.size().to_int_size().scale_by(SCALE).ok_or_else(|| wrong("it has no size".to_owned()))?;
    let mut pixels = Pixmap::new(size.width(), size.height()).ok_or_else(|| wrong(format!("{size:?} is too large")))?;
    resvg::render(&tree, Transform::from_scale(SCALE, SCALE), &mut pixels.as_mut());
    pixels.encode_png().map_err(|e| wrong(e.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_is_drawn() {
        let text = |text: &str| {
            format!(
                "<svg xmlns='http://www.w3.org/2000/svg' width='60' height='20'>\
                 <rect width='60' height='20' fill='#fff'/>\
                 <text x='2' y='16' font-family='sans-serif' font-size='16'>{text}</text></svg>"
            )
        };
        let (with, without) = (render(&text("d [m]")).unwrap(), render(&text("")).unwrap());
        assert!(with.len() > without.len() + 100, "{} bytes with text, {} without", with.len(), without.len());
    }
}
