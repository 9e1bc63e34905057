//! Prints the style sheet that the report page and the browser page share; `bindings/web/build` inserts it.

fn main() {
    print!("{}", view::style::sheet());
}
