//! What the pages that commands write have in common: head, colours and charts.

pub(crate) mod chart;

use maud::{Markup, PreEscaped, html};

/// Colours that colour-blind readers can distinguish (after Okabe and Ito), on white and on black.
const STYLE: &str = "\
    :root{color-scheme:light dark;--ink:#1d2830;--soft:#55646e;--page:#fff;--grid:#e2e7ea;--line:#a9b4bb;\
    --blue:#0072b2;--orange:#c35500;--green:#007e5c;--shade:#e8f1f7;--bad:#fbe3d6}\
    @media(prefers-color-scheme:dark){:root{--ink:#e4e9ec;--soft:#a3b0b8;--page:#14191d;--grid:#2b343a;\
    --line:#5b6870;--blue:#56b4e9;--orange:#f0a35e;--green:#35c79b;--shade:#1d2c36;--bad:#47291a}}\
    body{font:15px/1.5 system-ui,sans-serif;color:var(--ink);background:var(--page);margin:0 auto;\
    max-width:72rem;padding:1rem}\
    a{color:var(--blue)}a:focus-visible,[tabindex]:focus-visible,summary:focus-visible{outline:3px solid \
    var(--orange);outline-offset:2px}\
    .skip{position:absolute;left:-99rem}.skip:focus{position:static}\
    h1{font-size:1.6rem;margin:.4rem 0}h2{font-size:1.2rem;margin:2rem 0 .5rem;border-bottom:1px solid \
    var(--grid)}\
    nav ul{display:flex;flex-wrap:wrap;gap:.2rem 1rem;padding:0;list-style:none}\
    dl.tiles{display:grid;grid-template-columns:repeat(auto-fill,minmax(14rem,1fr));gap:.6rem;margin:1rem 0}\
    dl.tiles div{border:1px solid var(--grid);border-radius:.4rem;padding:.5rem .8rem}\
    dl.tiles .bad{background:var(--bad)}\
    dt{color:var(--soft);font-size:.85rem}dd{margin:0;font-size:1.15rem;font-variant-numeric:tabular-nums}\
    figure{margin:1rem 0}figcaption{color:var(--soft);font-size:.9rem}figcaption strong{color:var(--ink)}\
    .scroll{overflow-x:auto}svg{width:100%;min-width:40rem;height:auto;display:block}\
    svg text{font-size:12px;fill:var(--soft)}\
    .grid{stroke:var(--grid)}.frame{fill:none;stroke:var(--line)}.zero{stroke:var(--ink)}\
    .blue{fill:none;stroke:var(--blue);stroke-width:1.6;stroke-linejoin:round}\
    .green{fill:none;stroke:var(--green);stroke-width:1.3}.orange{fill:none;stroke:var(--orange);stroke-width:1.6;stroke-dasharray:7 4}\
    .dot{fill:var(--page);stroke:var(--blue);stroke-width:2}\
    .auto{fill:var(--shade)}.band{fill:var(--green);fill-opacity:.16}.dead{fill:var(--orange);fill-opacity:.16}\
    .bar{fill:var(--blue)}.range{fill:var(--blue);fill-opacity:.45}.mean{stroke:var(--orange);stroke-width:2.5}\
    .mode{fill:var(--shade);stroke:var(--line)}.run{fill:var(--green);fill-opacity:.3;stroke:var(--line)}\
    table{border-collapse:collapse;font-variant-numeric:tabular-nums;font-size:.9rem}\
    caption{text-align:left;color:var(--soft);padding:.2rem 0}\
    th,td{padding:.2rem .7rem;text-align:right;border-bottom:1px solid var(--grid);white-space:nowrap}\
    th.word,td.word{text-align:left}td.what{white-space:normal;text-align:left;min-width:20rem}\
    tr.bad{background:var(--bad)}\
    @media print{nav,.skip{display:none}}";

/// The head of a page that loads nothing, with `more` style than that of all pages.
pub(crate) fn head(title: &str, more: &str) -> Markup {
    html! {
        head {
            meta charset="utf-8";
            meta name="viewport" content="width=device-width, initial-scale=1";
            title { (title) }
            style { (PreEscaped(STYLE)) (PreEscaped(more)) }
        }
    }
}
