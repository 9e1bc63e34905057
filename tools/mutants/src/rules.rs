//! Rules: small changes of a file that change its meaning.

use proc_macro2::Span;
use std::collections::BTreeSet;
use std::ops::Range;
use syn::spanned::Spanned;
use syn::visit::{self, Visit};
use syn::{
    BinOp, Block, Expr, ExprMethodCall, ImplItemFn, Item, ItemFn, Lit, Member, Signature, Stmt,
    UnOp, Visibility,
};

/// Kind of a change.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, serde::Serialize, serde::Deserialize,
)]
#[serde(rename_all = "kebab-case")]
pub enum Rule {
    /// `any` for `all`, `&&` for `||`, `min` for `max`, or the reverse.
    AnyAll,
    /// `<` for `<=`, `>` for `>=`, or the reverse.
    Bound,
    /// Removes a statement that resets a value or calls a method.
    Reset,
    /// Removes a statement that updates a value.
    Stale,
    /// Replaces a name or index by its partner: front and rear, left and right, 0 and 1.
    Swap,
    /// Changes a sign.
    Sign,
    /// Multiplies a time by four.
    Time,
    /// Removes or negates a condition or a part of a condition.
    Guard,
}

/// Edit that makes a change.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Form {
    /// An expression is replaced by this text.
    Replaced(String),
    /// A statement is removed.
    Removed,
}

/// Change that is possible in a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Site {
    /// Rule of the change.
    pub rule: Rule,
    /// Byte range of the expression or statement in the file.
    pub bytes: Range<usize>,
    /// Edit that makes the change.
    pub form: Form,
    /// Line number in the file, from 1.
    pub line: usize,
}

/// All possible changes of a file, by position. `times` are the names of time constants.
pub fn sites(text: &str, times: &BTreeSet<String>) -> syn::Result<Vec<Site>> {
    let file = syn::parse_file(text)?;
    let mut finder = Finder {
        text,
        times,
        sites: Vec::new(),
    };
    finder.visit_file(&file);
    finder
        .sites
        .sort_by_key(|site| (site.bytes.start, site.rule));
    Ok(finder.sites)
}

/// Names of the constants of a file that are times, by type or unit.
pub fn time_constants(text: &str) -> syn::Result<BTreeSet<String>> {
    let file = syn::parse_file(text)?;
    let named = file.items.iter().filter_map(|item| match item {
        Item::Const(item) => Some((item.ident.to_string(), &*item.ty)),
        _ => None,
    });
    let is_time = |(name, ty): &(String, &syn::Type)| {
        let micros = matches!(ty, syn::Type::Path(path) if path.path.is_ident("Micros"));
        micros
            || ["_S", "_MS", "_US"]
                .iter()
                .any(|unit| name.ends_with(unit) && !is_rate(name))
    };
    Ok(named.filter(is_time).map(|(name, _)| name).collect())
}

/// True for the name of a speed, rate or acceleration, which also ends in `_s`.
fn is_rate(name: &str) -> bool {
    ["_m_s", "rad_s", "per_s", "_m_s2"]
        .iter()
        .any(|unit| name.to_ascii_lowercase().ends_with(unit))
}

struct Finder<'a> {
    text: &'a str,
    times: &'a BTreeSet<String>,
    sites: Vec<Site>,
}

impl Finder<'_> {
    fn of(&self, span: Span) -> &str {
        &self.text[span.byte_range()]
    }

    fn add(&mut self, rule: Rule, span: Span, form: Form) {
        self.sites.push(Site {
            rule,
            bytes: span.byte_range(),
            form,
            line: span.start().line,
        });
    }

    fn replace(&mut self, rule: Rule, span: Span, text: impl Into<String>) {
        self.add(rule, span, Form::Replaced(text.into()));
    }

    /// Text of the expression `whole` in which `text` replaces the part `part`.
    fn with(&self, whole: Span, part: Span, text: &str) -> String {
        let (whole, part) = (whole.byte_range(), part.byte_range());
        format!(
            "{}{text}{}",
            &self.text[whole.start..part.start],
            &self.text[part.end..whole.end]
        )
    }

    fn binary(&mut self, expr: &syn::ExprBinary) {
        let op = self.of(expr.op.span()).to_owned();
        let span = expr.span();
        let swap = |rule, to: &str| (rule, to.to_owned());
        let (rule, to) = match expr.op {
            BinOp::Lt(_) => swap(Rule::Bound, "<="),
            BinOp::Le(_) => swap(Rule::Bound, "<"),
            BinOp::Gt(_) => swap(Rule::Bound, ">="),
            BinOp::Ge(_) => swap(Rule::Bound, ">"),
            BinOp::Add(_) => swap(Rule::Sign, "-"),
            BinOp::Sub(_) => swap(Rule::Sign, "+"),
            BinOp::AddAssign(_) => swap(Rule::Sign, "-="),
            BinOp::SubAssign(_) => swap(Rule::Sign, "+="),
            BinOp::Eq(_) => swap(Rule::Guard, "!="),
            BinOp::Ne(_) => swap(Rule::Guard, "=="),
            BinOp::And(_) | BinOp::Or(_) => {
                let binds = |expr: &Expr| matches!(expr, Expr::Let(_));
                if !binds(&expr.left) && !binds(&expr.right) && !has_let(&expr.left) {
                    let other = if op == "&&" { "||" } else { "&&" };
                    let [left, right] =
                        [&expr.left, &expr.right].map(|side| self.of(side.span()).to_owned());
                    self.replace(Rule::AnyAll, span, format!("({left}) {other} ({right})"));
                    self.replace(Rule::Guard, span, left);
                    self.replace(Rule::Guard, span, right);
                }
                return;
            }
            _ => return,
        };
        let text = self.with(span, expr.op.span(), &to);
        self.replace(rule, span, text);
    }

    fn method(&mut self, call: &ExprMethodCall) {
        let name = call.method.to_string();
        let other = match name.as_str() {
            "any" => "all",
            "all" => "any",
            "min" => "max",
            "max" => "min",
            "is_some_and" => "is_none_or",
            "is_none_or" => "is_some_and",
            _ => "",
        };
        let span = call.span();
        if !other.is_empty() {
            let mut text = self.with(span, call.method.span(), other);
            if name == "is_some_and" {
                text = format!("({text})");
            }
            self.replace(Rule::AnyAll, span, text);
        }
        if ["filter", "min", "max", "take", "skip"].contains(&name.as_str()) {
            let receiver = self.of(call.receiver.span()).to_owned();
            self.replace(Rule::Guard, span, receiver);
        }
        let opposite = match name.as_str() {
            "is_some" => "is_none",
            "is_none" => "is_some",
            _ => return,
        };
        let text = self.with(span, call.method.span(), opposite);
        self.replace(Rule::Guard, span, text);
    }

    /// Adds the changes that remove a pattern of a `matches!`.
    fn alternatives(&mut self, expr: &syn::ExprMacro) {
        if !expr.mac.path.is_ident("matches") {
            return;
        }
        let span = expr.span();
        let Some(comma) = top_level(&expr.mac.tokens, ',').first().copied() else {
            return;
        };
        let bars: Vec<_> = top_level(&expr.mac.tokens, '|')
            .into_iter()
            .filter(|bar| *bar > comma)
            .collect();
        let whole = span.byte_range();
        if bars.is_empty() {
            let negated = format!("!{}", self.of(span));
            return self.replace(Rule::Guard, span, negated);
        }
        let mut starts = vec![comma + 1];
        starts.extend(bars.iter().map(|bar| bar + 1));
        for (k, start) in starts.iter().enumerate() {
            // The last pattern stays if a guard follows, because the guard applies to all patterns.
            let (from, to) = match bars.get(k) {
                Some(bar) => (*start, bar + 1),
                None if self.text[*start..whole.end].contains(" if ") => continue,
                None => (start - 1, whole.end - 1),
            };
            let text = format!(
                "{}{}",
                &self.text[whole.start..from],
                &self.text[to..whole.end]
            );
            self.replace(Rule::Guard, span, text);
        }
    }

    fn time(&mut self, name: &str, span: Span) {
        let named = [
            "timeout", "_time", "hold", "duration", "elapsed", "_for", "_periods", "since",
        ]
        .iter()
        .any(|part| name.ends_with(part));
        let unit = ["_s", "_ms", "_us"].iter().any(|unit| name.ends_with(unit));
        if self.times.contains(name) || (!is_rate(name) && (named || unit)) {
            let text = format!("crate::mutant::longer({})", self.of(span));
            self.replace(Rule::Time, span, text);
        }
    }

    /// Partner of a name, such as `right` for `left`; `None` for a name without a partner.
    fn pair(name: &str) -> Option<&'static str> {
        Some(match name {
            "Front" => "Rear",
            "Rear" => "Front",
            "FrontAxle" => "RearAxle",
            "RearAxle" => "FrontAxle",
            "left" => "right",
            "right" => "left",
            "front" => "rear",
            "rear" => "front",
            "left_m_s" => "right_m_s",
            "right_m_s" => "left_m_s",
            _ => return None,
        })
    }

    fn value(&mut self, expr: &Expr) {
        let span = expr.span();
        match expr {
            Expr::Binary(binary) => self.binary(binary),
            Expr::MethodCall(call) => self.method(call),
            Expr::Macro(expr) => self.alternatives(expr),
            Expr::Unary(unary) => {
                let operand = self.of(unary.expr.span()).to_owned();
                match unary.op {
                    UnOp::Neg(_) => self.replace(Rule::Sign, span, operand),
                    UnOp::Not(_) => self.replace(Rule::Guard, span, operand),
                    _ => {}
                }
            }
            Expr::Path(path) => {
                let Some(last) = path.path.segments.last() else {
                    return;
                };
                let name = last.ident.to_string();
                if let Some(other) = Self::pair(&name) {
                    let text = self.with(span, last.ident.span(), other);
                    self.replace(Rule::Swap, span, text);
                }
                self.time(&name, span);
            }
            Expr::Field(field) => {
                if let Member::Named(ident) = &field.member {
                    let name = ident.to_string();
                    if let Some(other) = Self::pair(&name) {
                        let text = self.with(span, ident.span(), other);
                        self.replace(Rule::Swap, span, text);
                    }
                    self.time(&name, span);
                }
            }
            Expr::Index(index) => {
                if let Expr::Lit(lit) = &*index.index
                    && let Lit::Int(int) = &lit.lit
                {
                    let other = match int.base10_digits() {
                        "0" => "1",
                        "1" => "0",
                        _ => return,
                    };
                    let text = self.with(span, lit.span(), other);
                    self.replace(Rule::Swap, span, text);
                }
            }
            Expr::If(expr) if !has_let(&expr.cond) => {
                let ends = expr.else_branch.is_none() && ends_in_jump(&expr.then_branch);
                let text = if ends { "false" } else { "true" };
                self.replace(Rule::Guard, expr.cond.span(), text);
            }
            Expr::Match(expr) => {
                for (_, guard) in expr.arms.iter().filter_map(|arm| arm.guard.as_ref()) {
                    if !has_let(guard) {
                        self.replace(Rule::Guard, guard.span(), "true");
                    }
                }
            }
            _ => {}
        }
    }

    /// Visits an expression that is written or borrowed. Its indices can change, the expression itself cannot.
    fn place(&mut self, expr: &Expr) {
        match expr {
            Expr::Field(field) => self.place(&field.base),
            Expr::Index(index) => {
                self.place(&index.expr);
                self.visit_expr(&index.index);
            }
            Expr::Unary(unary) => self.place(&unary.expr),
            Expr::Paren(paren) => self.place(&paren.expr),
            Expr::Tuple(tuple) => tuple.elems.iter().for_each(|expr| self.place(expr)),
            Expr::Path(_) => {}
            other => self.visit_expr(other),
        }
    }
}

impl<'ast> Visit<'ast> for Finder<'_> {
    fn visit_item(&mut self, item: &'ast Item) {
        let attributes = match item {
            Item::Fn(item) => &item.attrs,
            Item::Impl(item) => &item.attrs,
            Item::Mod(item) => &item.attrs,
            Item::Trait(_) => return visit::visit_item(self, item),
            // Other items are evaluated by the compiler or contain no code.
            _ => return,
        };
        let tested = |attribute: &syn::Attribute| {
            attribute.path().is_ident("cfg") && self.of(attribute.span()).contains("test")
        };
        if !attributes.iter().any(tested) {
            visit::visit_item(self, item);
        }
    }

    fn visit_item_fn(&mut self, item: &'ast ItemFn) {
        if may_run(&item.vis, &item.sig) {
            self.visit_block(&item.block);
        }
    }

    fn visit_impl_item_fn(&mut self, item: &'ast ImplItemFn) {
        if may_run(&item.vis, &item.sig) {
            self.visit_block(&item.block);
        }
    }

    fn visit_impl_item_const(&mut self, _: &'ast syn::ImplItemConst) {}

    fn visit_type(&mut self, _: &'ast syn::Type) {}

    fn visit_pat(&mut self, _: &'ast syn::Pat) {}

    fn visit_expr_repeat(&mut self, expr: &'ast syn::ExprRepeat) {
        self.visit_expr(&expr.expr);
    }

    fn visit_block(&mut self, block: &'ast Block) {
        for stmt in &block.stmts {
            if let Stmt::Expr(expr, Some(_)) = stmt {
                match expr {
                    Expr::Assign(assign) => {
                        let rule = if is_initial_value(&assign.right) {
                            Rule::Reset
                        } else {
                            Rule::Stale
                        };
                        self.add(rule, stmt.span(), Form::Removed);
                    }
                    Expr::Binary(binary) if is_update(&binary.op) => {
                        self.add(Rule::Stale, stmt.span(), Form::Removed);
                    }
                    Expr::MethodCall(_) => self.add(Rule::Reset, stmt.span(), Form::Removed),
                    _ => {}
                }
            }
        }
        visit::visit_block(self, block);
    }

    fn visit_expr(&mut self, expr: &'ast Expr) {
        self.value(expr);
        match expr {
            Expr::Assign(assign) => {
                self.place(&assign.left);
                self.visit_expr(&assign.right);
            }
            Expr::Binary(binary) if is_update(&binary.op) => {
                self.place(&binary.left);
                self.visit_expr(&binary.right);
            }
            Expr::Reference(reference) => self.place(&reference.expr),
            Expr::MethodCall(call) => {
                self.place(&call.receiver);
                call.args
                    .iter()
                    .for_each(|argument| self.visit_expr(argument));
            }
            Expr::Field(field) => self.place(&field.base),
            Expr::Index(index) => {
                self.place(&index.expr);
                self.visit_expr(&index.index);
            }
            Expr::Call(call) => call
                .args
                .iter()
                .for_each(|argument| self.visit_expr(argument)),
            _ => visit::visit_expr(self, expr),
        }
    }
}

/// True for a function that may run at run time; private `const` functions are taken as evaluated by the compiler.
fn may_run(visibility: &Visibility, signature: &Signature) -> bool {
    signature.constness.is_none() || matches!(visibility, Visibility::Public(_))
}

/// True for compound assignment such as `+=`.
fn is_update(op: &BinOp) -> bool {
    use BinOp::{
        AddAssign, BitAndAssign, BitOrAssign, BitXorAssign, DivAssign, MulAssign, RemAssign,
        ShlAssign, ShrAssign, SubAssign,
    };
    matches!(
        op,
        AddAssign(_)
            | SubAssign(_)
            | MulAssign(_)
            | DivAssign(_)
            | RemAssign(_)
            | BitXorAssign(_)
            | BitAndAssign(_)
            | BitOrAssign(_)
            | ShlAssign(_)
            | ShrAssign(_)
    )
}

/// True if the value is an initial value: a literal, constant, `default()` or `new()`.
fn is_initial_value(value: &Expr) -> bool {
    match value {
        Expr::Lit(_) => true,
        Expr::Path(path) => path.path.segments.last().is_some_and(|last| {
            let name = last.ident.to_string();
            name.starts_with(char::is_uppercase)
        }),
        Expr::Array(array) => array.elems.iter().all(is_initial_value),
        Expr::Tuple(tuple) => tuple.elems.iter().all(is_initial_value),
        Expr::Repeat(repeat) => is_initial_value(&repeat.expr),
        Expr::Call(call) => match &*call.func {
            Expr::Path(path) => {
                let last = path.path.segments.last().map(|last| last.ident.to_string());
                call.args.is_empty() && matches!(last.as_deref(), Some("default" | "new"))
            }
            _ => false,
        },
        _ => false,
    }
}

/// True if a condition contains `let`.
fn has_let(expr: &Expr) -> bool {
    match expr {
        Expr::Let(_) => true,
        Expr::Binary(binary) => has_let(&binary.left) || has_let(&binary.right),
        _ => false,
    }
}

/// True if a block ends with `return`, `continue` or `break`.
fn ends_in_jump(block: &Block) -> bool {
    let last = block.stmts.last();
    let Some(Stmt::Expr(expr, _)) = last else {
        return false;
    };
    matches!(expr, Expr::Return(_) | Expr::Continue(_) | Expr::Break(_))
}

/// Byte positions of the punctuation character `wanted` outside brackets.
fn top_level(tokens: &proc_macro2::TokenStream, wanted: char) -> Vec<usize> {
    let at = |token: proc_macro2::TokenTree| match token {
        proc_macro2::TokenTree::Punct(punct) if punct.as_char() == wanted => {
            Some(punct.span().byte_range().start)
        }
        _ => None,
    };
    tokens.clone().into_iter().filter_map(at).collect()
}
